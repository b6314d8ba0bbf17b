"""One point of a sweep on two B210s: the companion's flowgraph, its radios set up by `setup`."""

import functools
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.radio.calibration import CalibrationKey, store_latency_samples
from ...core.radio.interlock import require_enclosure
from ...core.scene import Scene
from ..flowgraph import FlowgraphError
from ..flowgraph.generate import Prepared, generated_here, shipped
from ..flowgraph.rewrite import RADAR_GATE, prune, with_second_channel
from ..flowgraph.run import attach_recorder, finish_recorder, load_class, result_of, run_to_end
from ..simulation import TAIL_FRAMES, PointResult
from .bring_up import bring_up, start_together
from .settings import radio_blocks
from .setup import FULL_SCALE, programme_over, set_up

_START_S = 3.0  # longest time from `set_up` to the first sample, s
_POLL_S = 0.02  # time between checks of the programme's end, s
_SETTLE_S = 0.02  # settling of UHD's DC correction at a receiver's start, s
_LISTEN_LIMIT_S = 30.0  # longest capture of a receiver alone, set-up included, s
_USB_TYPE = "b200"  # UHD's type of the radios on USB (docs/hardware.md); its others are on a network
_COUNTERS = ("saturated_frames", "lost_samples", "dropped_slow", "tx_underflows", "tx_late", "lock_losses")
TX_EVENTS = ("underflow", "underflow_in_packet", "seq_error", "seq_error_in_burst", "time_error")


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@functools.lru_cache(maxsize=8)
def _prepared(methods: tuple[str, ...], jammer: bool, two: bool) -> Prepared:
    """``ota_b210.grc`` generated for radios, with what the scene needs of chains, radios and receive channels."""
    data = prune(shipped(), methods, jammer)
    data = with_second_channel(data) if two else data
    data["options"]["parameters"]["id"] = f"ota_b210_{'jam' if jammer else 'clear'}{'_two' if two else ''}"
    return Prepared(generated_here(data), methods)


def _events() -> Any:
    """A block that counts the transmitters' asynchronous messages by their kind, in ``counts``."""
    import pmt
    from gnuradio import gr

    class sink(gr.basic_block):
        def __init__(self) -> None:
            gr.basic_block.__init__(self, "radalt_event_counter", [], [])
            self.counts: Counter[str] = Counter()
            port = pmt.intern("events")
            self.message_port_register_in(port)
            self.set_msg_handler(port, self.count)

        def count(self, message) -> None:  # noqa: ANN001 - a pmt
            text = pmt.write_string(message).replace("(", " ").replace(")", " ").split()
            self.counts.update(word for word in text if word in TX_EVENTS)

    return sink()


def run_hardware(
    scene: Scene,
    methods: Sequence[str],
    *,
    transmit: bool,
    calibration: Path | str | None = None,
    use_calibration: bool = True,
    capture: Path | str | None = None,
    silent: Sequence[str] = (),
    time_limit_s: float = 300.0,
    log: Callable[[str], None] = _print,
    sleep: Callable[[float], None] = time.sleep,
) -> PointResult:
    """Run a scene's programme once with radios; ``calibration``, ``use_calibration`` and ``log`` are `set_up`'s.

    The gates of ``silent`` stay closed: their transmitters send zeros; without the radar no timing is found, and the
    run ends with its last sample. The result's ``segmenter`` also holds ``saturated_frames``, ``tx_underflows``,
    ``tx_late``, ``calibrated`` and ``radio`` (type, serial). Raises InterlockError, FlowgraphError, CalibrationError,
    one line.
    """
    require_enclosure(scene, transmit)
    from gnuradio import uhd

    prepared = _prepared(tuple(methods), scene.has_jammer, scene.auxiliary is not None)
    top = load_class(prepared)(scene_file=scene, drop_when_slow=1, transmit=1)
    events = _events()
    for name in radio_blocks(scene):
        if name.endswith("_sink"):
            top.msg_connect((getattr(top, name), "async_msgs"), (events, "events"))
    ready = set_up(
        top, scene, uhd, calibration=calibration, use_calibration=use_calibration, log=log, sleep=sleep
    )
    for gate in silent:
        if hasattr(top, gate):
            getattr(top, gate).gate.close("transmit stopped: this run wants the transmitter silent")
    recorder = None
    if capture:
        source = top.radar_usrp_source
        radio = {"full_scale": FULL_SCALE}
        if ready.latency_samples is not None:
            radio["calibration_samples"] = ready.latency_samples
        recorder = attach_recorder(top, source, scene, capture, start_s=ready.start_s, radio=radio)
    try:
        elapsed = _fly(top, scene, time_limit_s, recorder=recorder, silent=RADAR_GATE in silent)
    finally:
        if recorder is not None:
            finish_recorder(top, recorder)
    result = result_of(top, prepared, scene, elapsed)
    result.segmenter |= {
        "tx_underflows": events.counts["underflow"] + events.counts["underflow_in_packet"],
        "tx_late": events.counts["time_error"] + events.counts["seq_error"],
        "calibrated": ready.latency_samples is not None,
        "latency_samples": top.frame_segmenter.latency_samples,
        "radio": (ready.key.device_type, ready.key.serial),
    }
    log("counters: " + ", ".join(f"{key} {result.segmenter[key]}" for key in _COUNTERS))
    return result


def _fly(top: Any, scene: Scene, time_limit_s: float, *, recorder: Any = None, silent: bool = False) -> float:
    """Run until the programme's last frame has come in, and is recorded; a receiver has no end of its own.

    ``silent``: no frame is to be expected, only samples.
    """
    programme, n = scene.altitude.programme, scene.waveform.samples_per_frame
    last = (programme.total_frames + TAIL_FRAMES) * n

    def over() -> bool:
        if recorder is not None and recorder.sample_counter < last:
            return False
        return top.frame_segmenter.segmenter.sample_counter >= last if silent else programme_over(top, scene)

    def too_long(limit_s: float) -> str:
        counter = top.frame_segmenter.segmenter.sample_counter
        if counter < 0:
            return (
                f"after {limit_s:.0f} s the receiver's time is still {-counter / scene.waveform.rate_hz:.3g} s before "
                "the common start: it took another time zero or ignored its start time; start again"
            )
        cable = "USB connection" if scene.radio.limits.uhd_type == _USB_TYPE else "network connection"
        return (
            f"only {counter / n:.0f} of {programme.total_frames} frames came in within {limit_s:.0f} s; "
            f"check the receiver's {cable}"
        )

    return run_to_end(
        top,
        time_limit_s=min(time_limit_s, 4 * programme.total_frames * scene.waveform.sweep_s + _START_S + 10.0),
        over=over,
        poll_s=_POLL_S,
        too_long=too_long,
    )


def receive_alone(
    scene: Scene,
    count: int,
    *,
    log: Callable[[str], None] = _print,
    sleep: Callable[[float], None] = time.sleep,
) -> np.ndarray:
    """(count,) complex64 samples of the radar's receiver, whose radio is opened for that alone: nothing transmits.

    Raises `FlowgraphError` as `bring_up`, or if they do not come within 30 s.
    """
    from gnuradio import blocks, gr, uhd

    radio, skip = scene.radio, round(_SETTLE_S * scene.waveform.rate_hz)
    address = f"serial={radio.radar_serial}," if radio.radar_serial else ""
    stream = uhd.stream_args(cpu_format="fc32", args="", channels=[0])
    top = gr.top_block()
    top.radar_usrp_source = uhd.usrp_source(f"{address}master_clock_rate={radio.master_clock_hz:.0f}", stream)
    for entry in bring_up(top, scene, uhd, sleep):
        log(str(entry))
    start_together(top, scene, uhd)
    sink = blocks.vector_sink_c(1, skip + count)
    top.connect(top.radar_usrp_source, blocks.head(gr.sizeof_gr_complex, skip + count), sink)
    run_to_end(top, time_limit_s=_LISTEN_LIMIT_S)
    return np.array(sink.data()[skip:], np.complex64)


def calibrate(
    scene: Scene, *, transmit: bool, calibration: Path | str | None = None, **options: Any
) -> tuple[float, Path]:
    """Measure the latency over a direct, attenuated cable from TX to RX and store it; returns samples and file.

    Runs the scene's programme without jammer and without an earlier calibration.
    """
    quiet = scene.at(overlap=0.0) if scene.interference else scene
    result = run_hardware(
        quiet, ("none",), transmit=transmit, calibration=calibration, use_calibration=False, **options
    )
    frames = result.results["none"]
    latency = result.segmenter["latency_samples"]
    if not frames["valid"].any():
        raise FlowgraphError("calibration: no altitude was found; check the cable from TX/RX to RX2")
    key = CalibrationKey(*result.segmenter["radio"], scene.radio.master_clock_hz, scene.waveform.rate_hz)
    path = store_latency_samples(latency, key, calibration)
    return latency, path
