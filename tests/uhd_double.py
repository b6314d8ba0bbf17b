"""Two B210s at the boundary of gr-uhd's calls: blocks that record what is called on them and share one air.

The double keeps what UHD promises: time per device, pulses once a virtual second, an ``rx_time`` tag at the start
time, transmit samples divided by the stream argument ``fullscale`` and clipped at 1, ``async_msgs``."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np
import pmt
from gnuradio import gr, uhd

LATENCY = 150  # samples from TX to RX
AHEAD = 100 * 7500  # samples that a transmitter, which sends at the sample rate, may be ahead of the receiver

# of a scene: both in one enclosure, on one clock
RADIO = {
    "radar_serial": "R",
    "jammer_serial": "J",
    "enclosure": "cabled",
    "attenuation_db": 40.0,
    "radar_tx_gain_db": 40.0,
    "jammer_tx_gain_db": 50.0,
    "radar_rx_gain_db": 20.0,
    "clock_source": "external",
}


@dataclass(kw_only=True, eq=False)
class Air:
    """Virtual time, moved by `sleep` alone or, if ``ticking``, by the machine's; recorded calls; samples on the way."""

    master_clock_hz: float | None = None  # None: the one asked for
    locks: bool = True
    gain: float = 0.5
    ticking: bool = False
    mboard_id: str = "B210"
    sensors: tuple[str, ...] = ("lo_locked",)
    deaf: frozenset[str] = frozenset()  # devices that receive noise alone
    event: str = "underflow"  # the message of each transmitter at its start

    def __post_init__(self) -> None:
        self.calls: list[tuple] = []
        self.slept, self.zero, self.begin = 100.25, {}, time.monotonic()
        self.lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Nothing on the way: before a flowgraph's first block is made."""
        self._room = {device: np.zeros(0, np.complex64) for device in ("radar", "jammer")}
        self.sent = dict(self._room)  # the filled start of each
        self.given = 0  # samples that the receiver has taken
        self.ended: set[str] = set()
        self.blocks: list[object] = []
        self.over = False

    @property
    def now(self) -> float:
        """Seconds since some time before both devices were switched on."""
        return self.slept + (time.monotonic() - self.begin if self.ticking else 0.0)

    def sleep(self, seconds: float) -> None:
        self.slept += seconds

    def device_time(self, device: str) -> float:
        return self.now - self.zero.get(device, 0.0)

    def send(self, device: str, samples: np.ndarray) -> None:
        while self.sent[device].size > self.given + AHEAD and not (self.ended or self.over):
            time.sleep(0.001)
        with self.lock:
            first, end = self.sent[device].size, self.sent[device].size + samples.size
            if end > self._room[device].size:  # at least doubled, or each call copies all that was sent
                self._room[device] = np.concatenate([self.sent[device], np.empty(end, np.complex64)])
            self._room[device][first:end] = samples
            self.sent[device] = self._room[device][:end]

    def receive(self, first: int, count: int) -> np.ndarray:
        """What arrives; fewer samples while a transmitter that is still sending has not got so far."""
        with self.lock:
            for device in {b.device for b in self.blocks if isinstance(b, Sink)} - self.ended:
                count = min(count, self.sent[device].size + LATENCY - first)
            out = np.zeros(max(0, count), np.complex64)
            for samples in self.sent.values():
                low, high = first - LATENCY, first - LATENCY + out.size
                part = samples[max(0, low) : max(0, high)]
                out[max(0, -low) : max(0, -low) + part.size] += part
            self.given = first + out.size
        return out


class _Radio:
    """The calls both kinds of block have."""

    def _init_radio(self, air: Air, args: str, stream_args) -> None:
        if air.over:
            air.reset()
        self.air, self.args = air, args
        self.asked_clock_hz = float(args.rpartition("master_clock_rate=")[2] or 30e6)
        self.kind = type(self).__name__
        self.device = "jammer" if "serial=J" in args else "radar"
        self.full_scale = float(
            dict(p.split("=") for p in str(stream_args.args.to_string()).split(",") if p).get("fullscale", 1)
        )
        self.state: dict[str, object] = {}
        self._record("construct", args)
        self._keep = [air.blocks.append(self)]

    def _record(self, call: str, *args) -> None:
        plain = []
        for arg in args:
            if isinstance(arg, uhd.time_spec):
                arg = ("time", arg.get_real_secs())
            elif isinstance(arg, uhd.tune_request):
                arg = ("tune", arg.target_freq, abs(arg.rf_freq - arg.target_freq))
            plain.append(arg)
        self.air.calls.append((f"{self.device} {self.kind}", call, *plain))
        if call.startswith("set_"):
            self.state[call] = plain[0]

    def get_samp_rate(self) -> float:
        clock_hz = self.get_clock_rate()
        return clock_hz / max(1, int(clock_hz / self.state["set_samp_rate"]))

    def get_clock_rate(self, mboard: int = 0) -> float:
        return self.air.master_clock_hz or self.asked_clock_hz

    def get_usrp_info(self, chan: int = 0) -> dict[str, str]:
        return {"mboard_id": self.air.mboard_id, "mboard_serial": self.device[0].upper()}

    def get_gain(self, chan: int = 0) -> float:
        return self.state["set_gain"]

    def get_antenna(self, chan: int = 0) -> str:
        return self.state["set_antenna"]

    def get_center_freq(self, chan: int = 0) -> float:
        return self.state["set_center_freq"][1] + 0.4

    def get_sensor_names(self, chan: int = 0) -> tuple[str, ...]:
        return self.air.sensors

    def get_sensor(self, name: str, chan: int = 0):
        self._record("get_sensor", name)
        return uhd.sensor_value(name, self.air.locks, "locked", "unlocked")

    def get_mboard_sensor(self, name: str, mboard: int = 0):
        self._record("get_mboard_sensor", name)
        return uhd.sensor_value(name, self.air.locks, "locked", "unlocked")

    def set_time_now(self, spec, mboard: int = 0) -> None:
        self._record("set_time_now", spec)
        self.air.zero[self.device] = self.air.now - spec.get_real_secs()

    def set_time_next_pps(self, spec) -> None:
        self._record("set_time_next_pps", spec)
        self.air.zero[self.device] = np.floor(self.air.now) + 1.0 - spec.get_real_secs()

    def get_time_now(self, mboard: int = 0):
        return uhd.time_spec(self.air.device_time(self.device))

    def get_time_last_pps(self, mboard: int = 0):
        return uhd.time_spec(float(np.floor(self.air.now) - self.air.zero.get(self.device, 0.0)))


def _recorded(name: str):
    return lambda self, *args: self._record(name, *args)


for _name in ("clock_source", "time_source", "samp_rate", "antenna", "gain", "center_freq", "bandwidth", "start_time",
              "subdev_spec", "rx_agc", "auto_dc_offset", "auto_iq_balance"):  # fmt: skip
    setattr(_Radio, f"set_{_name}", _recorded(f"set_{_name}"))


class Sink(_Radio, gr.sync_block):
    """``uhd.usrp_sink``."""

    def __init__(self, air: Air, args: str, stream_args, tag: str = "") -> None:
        gr.sync_block.__init__(self, "double_sink", [np.complex64], None)
        self._init_radio(air, args, stream_args)
        self.message_port_register_out(pmt.intern("async_msgs"))

    def start(self) -> bool:
        self._record("start")
        events = pmt.list1(pmt.intern(self.air.event))
        value = pmt.dict_add(pmt.make_dict(), pmt.intern("event_code"), events)
        self.message_port_pub(pmt.intern("async_msgs"), pmt.cons(pmt.intern("uhd_async_msg"), value))
        return True

    def work(self, input_items, output_items) -> int:
        samples = input_items[0] / self.full_scale
        rails = samples.view(np.float32)
        self.air.send(self.device, np.clip(rails, -1, 1).view(np.complex64))
        return len(input_items[0])

    def stop(self) -> bool:
        self.air.ended.add(self.device)
        return True


class Source(_Radio, gr.sync_block):
    """``uhd.usrp_source``."""

    def __init__(self, air: Air, args: str, stream_args, *rest) -> None:
        channels = max(1, len(stream_args.channels))
        gr.sync_block.__init__(self, "double_source", None, [np.complex64] * channels)
        self._init_radio(air, args, stream_args)
        self._rng = np.random.default_rng(5)

    def start(self) -> bool:
        self._record("start")
        return True

    def work(self, input_items, output_items) -> int:
        out = output_items[0]
        first = self.nitems_written(0)
        # a transmitter's block stops with its stream; the receiver listens on, into silence
        samples = self.air.receive(first, len(out))
        if samples.size == 0:
            time.sleep(0.001)
            return 0
        if first == 0:
            seconds = self.state["set_start_time"][1]
            value = pmt.make_tuple(pmt.from_uint64(int(seconds)), pmt.from_double(seconds % 1.0))
            self.add_item_tag(0, 0, pmt.intern("rx_time"), value)
        noise = self._rng.standard_normal(2 * samples.size, dtype=np.float32).view(np.complex64)
        gain = 0.0 if self.device in self.air.deaf else self.air.gain
        received = np.float32(gain) * samples + np.float32(1e-3) * noise
        out[: samples.size] = np.clip(received.view(np.float32), -1, 1).view(np.complex64)
        for second in output_items[1:]:  # in the antenna's shadow: the same 20 dB weaker, and its own noise
            second[: samples.size] = np.float32(0.1) * (received + 1e-3j * noise.conj())
        return samples.size

    def stop(self) -> bool:
        self.air.over = True
        return True


def install(monkeypatch, air: Air) -> None:
    """Put the double in the place of gr-uhd's blocks."""
    monkeypatch.setattr(uhd, "usrp_sink", lambda *args: Sink(air, *args))
    monkeypatch.setattr(uhd, "usrp_source", lambda *args: Source(air, *args))
