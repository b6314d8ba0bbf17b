"""Flowgraphs as data: ``ota_b210.grc`` is the only flowgraph, all others are derived from it.

For simulation, one simulated channel replaces the three UHD blocks and the gates before the transmitters, blocks for
radios only are removed, and no frame is dropped; blocks that the scene does not need are disabled.
"""

import copy
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...core.mitigation import CUSTOM, METHODS
from ...core.parsing import load_yaml
from . import FlowgraphError

RADAR_SINK, RADAR_SOURCE, JAMMER_SINK = "radar_usrp_sink", "radar_usrp_source", "jammer_usrp_sink"
CHANNEL, CANCELLER = "simulated_channel", "auxiliary_cancel"
SUBDEVICES = "A:A A:B"  # UHD's subdevice specification of a B210's two receive channels
RADAR_GATE, JAMMER_GATE = "radar_gate", "jammer_gate"
_RADIOS_ALONE = ("import_interlock", "import_levels", "set_up_radios", "transmit", "transmit_interlock")
_DROP = "drop_when_slow"  # parameter of the segmenter
_UHD_BLOCKS = {RADAR_SINK: (CHANNEL, "0"), JAMMER_SINK: (CHANNEL, "1"), RADAR_SOURCE: (CHANNEL, "0")}


def load_grc(path: Path) -> dict[str, Any]:
    """A .grc file as nested mappings."""
    return load_yaml(path, what="flowgraph")


def simulate(data: dict[str, Any], name: str = "ota_sim", *, realtime: bool = False) -> dict[str, Any]:
    """The flowgraph, under another identifier, with one simulated channel in place of its UHD blocks.

    Gates, interlock and set-up of the radios are removed; the source before a gate is connected to the channel.
    Frames are never dropped, since waiting loses nothing in simulation. Nothing else differs. With ``realtime`` the
    channel limits the throughput to the sample rate, as radios do.
    """
    data, blocks = _renamed(data, name)
    options = data["options"]["parameters"]
    texts = [(options, "title"), (options, "description")]
    for parameters, key in [*texts, *((block["parameters"], "comment") for block in data["blocks"])]:
        parameters[key] = _AIR_WORDS.sub(lambda words: _SIMULATED_WORDS[words[0]], parameters.get(key, ""))
    ports = {"scene": "scene", "jammer": str(JAMMER_SINK in blocks), "realtime": str(realtime)}
    channel = _block(CHANNEL, "radalt_simulated_channel", ports, blocks[RADAR_SINK])
    gates = {name for name, block in blocks.items() if block["id"] == "radalt_transmit_gate"}
    fed_by = {sink: (source, port) for source, port, sink, _ in data["connections"] if sink in gates}
    data["connections"] = [
        [*_at_channel(*fed_by.get(source, (source, port))), *_at_channel(sink, sink_port)]
        for source, port, sink, sink_port in data["connections"]
        if sink not in gates
    ]
    gone = {*_UHD_BLOCKS, *_RADIOS_ALONE, *gates}
    data["blocks"] = [block for block in data["blocks"] if block["name"] not in gone] + [channel]
    for block in data["blocks"]:
        if block["name"] == _DROP:
            block["parameters"]["value"] = "0"
        elif realtime and "own_process" in block["parameters"]:
            block["parameters"]["own_process"] = "True"  # a radio's flowgraph has it where it drops
    return data


def _at_channel(block: str, port: str) -> tuple[str, str]:
    """A UHD block's port as the channel's."""
    return _UHD_BLOCKS.get(block, (block, port))


_SIMULATED_WORDS = {
    "Radar on one B210, jammer on the other": "Radar and jammer",
    "two B210s": "simulated channel",
    "Two B210s": "Simulated channel",
    "Radar B210 and jammer B210 over the air": "Radar and jammer in the simulated channel",
}
_AIR_WORDS = re.compile("|".join(_SIMULATED_WORDS))


def with_chain(data: dict[str, Any], name: str) -> dict[str, Any]:
    """The flowgraph with the chain of another method, ``mitigation_<name>`` to ``altimeter_<name>``, a copy of
    whitening's.
    """
    data = copy.deepcopy(data)
    lowest = max(b["states"]["coordinate"][1] for b in data["blocks"] if b["name"].startswith("altimeter_"))
    for kind, method in (("mitigation", f'"{name}"'), ("altimeter", name)):
        block = copy.deepcopy(next(b for b in data["blocks"] if b["name"] == f"{kind}_whitening"))
        block["name"], block["parameters"]["method"] = f"{kind}_{name}", method
        block["states"]["coordinate"] = [block["states"]["coordinate"][0], lowest + 80]
        data["blocks"].append(block)
    chain = [c for c in data["connections"] if f"{c[0]} {c[2]}".count("_whitening")]
    data["connections"] += [
        [p.replace("_whitening", f"_{name}") if i % 2 == 0 else p for i, p in enumerate(c)] for c in chain
    ]
    return data


def from_recording(data: dict[str, Any], name: str = "ota_replay") -> dict[str, Any]:
    """The flowgraph with a recording in place of the receiver, without transmitters.

    It has the further parameters ``capture_file`` and ``follow_programme``.
    """
    data, blocks = _renamed(data, name)
    gone = {RADAR_SINK, JAMMER_SINK, RADAR_GATE, JAMMER_GATE, "chirp_source", "jammer_source"}
    receiver = blocks[RADAR_SOURCE]
    receiver["id"] = "radalt_sigmf_source"
    receiver["parameters"] = {"scene": "scene", "file": "capture_file"}
    blocks["frame_segmenter"]["parameters"]["follow_programme"] = "bool(follow_programme)"
    added = [
        _parameter("capture_file", "SigMF recording", "str", '""', receiver),
        _parameter("follow_programme", "Altitudes by the scene", "intx", "1", receiver),
    ]
    data["blocks"] = [block for block in data["blocks"] if block["name"] not in gone] + added
    data["connections"] = [c for c in data["connections"] if c[0] not in gone and c[2] not in gone]
    return data


def prune(data: dict[str, Any], methods: Sequence[str], jammer: bool) -> dict[str, Any]:
    """Disable the chains of other methods and an unneeded jammer; add missing chains.

    Raises FlowgraphError if a method is neither in the flowgraph nor registered.
    """
    data = copy.deepcopy(data)
    names = {block["name"] for block in data["blocks"]}
    have = {name.removeprefix("altimeter_") for name in names if name.startswith("altimeter_")}
    known = sorted(have | {*METHODS, CUSTOM})
    for method in methods:
        if method not in known:
            raise FlowgraphError(f"unknown method {method!r}; known: {', '.join(known)}")
        if method not in have:
            data = with_chain(data, method)
            have.add(method)
    unneeded = {f"{kind}_{m}" for m in have - set(methods) for kind in ("mitigation", "altimeter")}
    if not jammer:
        unneeded |= {"jammer_source", JAMMER_GATE, JAMMER_SINK}
    for block in data["blocks"]:
        if block["name"] in unneeded:
            block["states"]["state"] = "disabled"
        if block["name"] == CHANNEL and not jammer:
            block["parameters"]["jammer"] = "False"
    return data


def with_second_channel(data: dict[str, Any]) -> dict[str, Any]:
    """The flowgraph with a second receive channel, and an `auxiliary_cancel` between the segmenter and everything else.

    With radios both channels are of one UHD block, so on one LO and sample clock.
    """
    data = copy.deepcopy(data)
    blocks = {block["name"]: block for block in data["blocks"]}
    blocks["frame_segmenter"]["parameters"]["auxiliary"] = "True"
    if CHANNEL in blocks:
        receiver = CHANNEL
        blocks[CHANNEL]["parameters"]["auxiliary"] = "True"
    else:
        receiver = RADAR_SOURCE
        own = blocks[RADAR_SOURCE]["parameters"]
        own |= {"nchan": "2", "sd_spec0": f'"{SUBDEVICES}"', "stream_chans": "[0, 1]"}
        own |= {"ant1": own["ant0"], "center_freq1": own["center_freq0"]}
        own |= {"rx_agc0": "False", "rx_agc1": "False", "gain1": "scene.radio.auxiliary_rx_gain_db"}
    scene = {"scene": "scene"}
    data["blocks"].append(_block(CANCELLER, "radalt_auxiliary_cancel", scene, blocks["frame_segmenter"]))
    for connection in data["connections"]:
        if connection[:2] == ["frame_segmenter", "0"]:
            connection[0] = CANCELLER
    data["connections"] += [[receiver, "1", "frame_segmenter", "1"]]
    data["connections"] += [["frame_segmenter", port, CANCELLER, port] for port in "01"]
    return data


def tracked(data: dict[str, Any], name: str) -> dict[str, Any]:
    """The flowgraph with an altitude tracker instead of every altimeter, connected to the segmenter's status.

    A tracker after a method also receives the frames before mitigation.
    """
    data, _ = _renamed(data, name)
    for block in data["blocks"]:
        if block["id"] == "radalt_altimeter_sink":
            block["id"] = "radalt_altitude_tracker"
            data["connections"].append(["frame_segmenter", "status", block["name"], "timing"])
            if block["name"] != "altimeter_none":
                block["parameters"]["received"] = "True"
                data["connections"].append(["frame_segmenter", "0", block["name"], "1"])
    return data


def remote(data: dict[str, Any], name: str) -> dict[str, Any]:
    """The flowgraph without end: altitudes by hand, any altitude accepted, results and requests over ZMQ."""
    data, blocks = _renamed(data, name)
    blocks["frames"]["parameters"]["value"] = "0"
    blocks["frame_segmenter"]["parameters"]["follow_programme"] = "False"
    blocks["chirp_source"]["parameters"]["altitude_m"] = "0.0"
    for gate in (RADAR_GATE, JAMMER_GATE):  # a simulated flowgraph has none
        if gate in blocks:
            blocks[gate]["parameters"]["controlled"] = "bool(control)"
    scene = blocks["scene"]
    scene["parameters"]["value"] = f"by_hand({scene['parameters']['value']})"
    ports = {"scene": "scene", "network": "bool(network)"}
    ports |= {key: key for key in ("telemetry", "control", "keep_alive_s")}
    data["blocks"] += [
        _block("import_by_hand", "import", {"imports": "from radalt.core.scene.live import by_hand"}, scene),
        _parameter("telemetry", "Telemetry (PUB)", "str", '""', scene),
        _parameter("control", "Control (REP)", "str", '""', scene),
        _parameter("network", "Allow other machines", "intx", "0", scene),
        _parameter("keep_alive_s", "Keep alive (s)", "eng_float", "0", scene),
        _block("remote_control", "radalt_remote_control", ports, scene),
    ]
    return data


def _renamed(data: dict[str, Any], name: str) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """A copy of a flowgraph under another identifier, and its blocks by name."""
    data = copy.deepcopy(data)
    data["options"]["parameters"]["id"] = name
    return data, {block["name"]: block for block in data["blocks"]}


def _block(name: str, kind: str, parameters: dict[str, str], pattern: dict[str, Any]) -> dict[str, Any]:
    """A new block in the place of another one."""
    return {"name": name, "id": kind, "parameters": parameters, "states": copy.deepcopy(pattern["states"])}


def _parameter(name: str, label: str, kind: str, value: str, pattern: dict[str, Any]) -> dict[str, Any]:
    return _block(name, "parameter", {"label": label, "type": kind, "value": value}, pattern)
