"""Simulated channel between two B210s, with their front ends, sample by sample (docs/design.md).

The channel works in blocks of one frame, counted from the transmitter's first sample, for any size of input chunks:
a run is a function of its seed, bit for bit. Every impairment is off by default and then costs nothing.
"""

import numpy as np

from ..programme import Programme
from ..returns.landing import TerrainPlayer
from ..waveform import Waveform, altitude_to_delay_s, exp_cycles
from .auxiliary import AuxiliaryReceiver, convert
from .delay_line import HALF_TAPS, MOST_BLOCKS, STEPS, DelayLine
from .noise import ReceiverNoise
from .settings import ChannelSettings


class SimulatedChannel:
    """Channel from the radar's and the jammer's transmitter to the radar's receiver, one frame at a time.

    A drawn latency lies within 80..N-2 samples, so that the interpolation kernel stays causal.

    - ``seed``: of everything random
    - ``true_delay``: altitudes simulated as true delays with Doppler and carrier phase; None where the source shifts
      the beat
    - ``terrain``: terrain return, in place of the transmitted sweep
    - ``frames``: length of the run; gaps are spread over it
    - ``auxiliary``: the second receive channel
    """

    MIN_LATENCY = 80

    def __init__(
        self,
        waveform: Waveform,
        settings: ChannelSettings = ChannelSettings(),  # noqa: B008 - frozen
        *,
        seed: int = 0,
        true_delay: Programme | None = None,
        terrain: TerrainPlayer | None = None,
        frames: int = 1000,
        auxiliary: AuxiliaryReceiver | None = None,
    ) -> None:
        self.waveform, self.settings, self.true_delay = waveform, settings, true_delay
        self.auxiliary = auxiliary
        self.terrain = terrain
        self.seed = seed
        self.rng = np.random.default_rng([seed, 0xC4A])
        n = waveform.samples_per_frame
        self._n = n
        low = min(self.MIN_LATENCY, n // 4)
        drawn = self.rng.uniform(low, n - 2)
        wanted = settings.start_offset_samples
        if wanted is not None and wanted != int(wanted) and wanted < HALF_TAPS:
            raise ValueError(
                f"channel.start_offset_samples {wanted:g} has a fraction and is below the kernel's {HALF_TAPS}; "
                f"use a whole number or at least {HALF_TAPS}"
            )
        self.latency_samples = drawn if wanted is None else float(wanted)
        top_s = 0.0
        if true_delay is not None:
            farthest_m = max(*true_delay.altitudes_m, settings.leakage_m, settings.gear_m)
            top_s = float(altitude_to_delay_s(farthest_m))
            if self.latency_samples < HALF_TAPS:
                raise ValueError(
                    f"true delays need channel.start_offset_samples of at least {HALF_TAPS}, or none"
                )
        if settings.return_multipath is not None:
            top_s += float(settings.return_multipath.delays_s.max())
        self._radar = DelayLine(n, self.latency_samples + top_s * waveform.rate_hz, repeats=True)
        self._jammer_base = self.latency_samples + settings.jammer_delay_samples
        fractional = settings.jammer_clock_ppm or self._jammer_base != int(self._jammer_base)
        if fractional and self._jammer_base < HALF_TAPS:
            raise ValueError(
                f"channel.jammer_clock_ppm {settings.jammer_clock_ppm:g} and jammer_delay_samples "
                f"{settings.jammer_delay_samples:g} need fractions of a sample, which start_offset_samples "
                f"{self.latency_samples:g} leaves no room for; use at least {HALF_TAPS}, or none"
            )
        if settings.jammer_clock_ppm > 0:  # a fast jammer clock eats into the delay
            self._jammer_base += n
        slow = settings.jammer_clock_ppm < 0  # its delay grows by up to a frame
        early, late = (0.0, 0.0) if auxiliary is None else np.multiply(auxiliary.reach_s, waveform.rate_hz)
        if auxiliary is not None and self._jammer_base + early < HALF_TAPS:
            raise ValueError(
                f"channel.start_offset_samples and jammer_delay_samples are {self._jammer_base:g} together; a second "
                f"channel needs {HALF_TAPS - early:.6g}, since its delay has a fraction"
            )
        directions = 1 if auxiliary is None else len(auxiliary.directions)
        most = self._jammer_base + late + (n if slow else 0)
        self._jammers = [DelayLine(n, most) for _ in range(directions)]
        self._noise = ReceiverNoise(n, [seed, 0x401])
        self._gaps = self._draw_gaps(frames)
        self._gains = self._draw_multipath(frames)
        self._block = 0
        # impairments that change from frame to frame are applied frame by frame
        changes = (
            true_delay is not None
            or terrain is not None
            or self._gains is not None
            or settings.jammer_clock_ppm
            or settings.jammer_lo_offset_hz
            or auxiliary is not None
        )
        self._at_once = 1 if changes else MOST_BLOCKS

    def _draw_multipath(self, frames: int) -> np.ndarray | None:
        """(taps, frames) gains of the return's paths, or None; drawn from a separate generator."""
        channel = self.settings.return_multipath
        if channel is None:
            return None
        limit_hz = 0.5 / self.waveform.sweep_s
        if channel.doppler_hz > limit_hz:
            raise ValueError(
                f"channel.return_multipath.doppler_hz is {channel.doppler_hz:g}; gains move once a frame, at most "
                f"{limit_hz:g} Hz"
            )
        rng = np.random.default_rng([self.seed, 0xFAD])
        return channel.draw(rng).gains(np.arange(frames + 8) * self.waveform.sweep_s).T

    def _draw_gaps(self, frames: int) -> list[tuple[int, int]]:
        """Sorted (first sample, length) of lost samples, clear of the first 20 frames and of each other."""
        drops = self.settings.drops
        if not drops.count:
            return []
        first, last = 20 * self._n, (frames - 5) * self._n
        if last - first < drops.count * (drops.max_samples + self._n):
            raise ValueError(
                f"channel.drops: {drops.count} gaps do not fit a run of {frames} frames; lengthen it or drop fewer"
            )
        lengths = self.rng.integers(drops.min_samples, drops.max_samples + 1, drops.count)
        free = last - first - int(lengths.sum()) - drops.count * self._n
        starts = np.sort(self.rng.integers(0, free, drops.count))
        starts = first + starts + np.concatenate([[0], np.cumsum(lengths[:-1] + self._n)])
        return [(int(s), int(length)) for s, length in zip(starts, lengths, strict=True)]

    @property
    def memory_frames(self) -> int:
        """Transmitted frames before one on which that may depend."""
        return max(self._radar.memory_blocks, self._jammers[0].memory_blocks)

    def skip(self, frames: int) -> None:
        """Start ``frames`` later: the `memory_frames` after it are then not received as they would have been."""
        self._block += frames
        self._noise.skip(frames)
        if self.auxiliary is not None:
            self.auxiliary.skip(frames)

    @property
    def gaps(self) -> tuple[tuple[int, int], ...]:
        """Gaps ahead: (first sample, length)."""
        return tuple(self._gaps)

    def process(
        self,
        radar: np.ndarray,
        jammer: np.ndarray | None = None,
        out: np.ndarray | None = None,
        second: np.ndarray | None = None,
    ) -> list[tuple[int, np.ndarray]]:
        """Received pieces, as (sample counter, samples), of one or more frames of each transmitter.

        A gap is a jump of the counter. The samples do not depend on the number of frames per call, to the bit. If
        ``out`` is given (complex64, as many samples), the pieces are views of it. ``second`` takes as many samples of
        the second channel, lost ones included. With several directions ``jammer`` has a row for each.
        """
        n = self._n
        if radar.ndim != 1 or not radar.size or radar.size % n:
            raise ValueError(f"the channel takes blocks of {n} samples, got {radar.shape}")
        out = np.empty(radar.size, dtype=np.complex64) if out is None else out
        pieces, step = [], n * self._at_once
        for first in range(0, radar.size, step):
            span = slice(first, first + step)
            jam = None if jammer is None else jammer[..., span]
            pieces += self._blocks(radar[span], jam, out[span], None if second is None else second[span])
        return pieces

    def _blocks(
        self, radar: np.ndarray, jammer: np.ndarray | None, out: np.ndarray, second: np.ndarray | None
    ) -> list[tuple[int, np.ndarray]]:
        """As `process`, for at most as many frames as one push of the delay lines takes."""
        s, count = self.settings, radar.size // self._n
        self._radar.push(self.terrain.echo(self._block, radar) if self.terrain is not None else radar)
        whole, gain = out.reshape(count, self._n), np.float32(10.0 ** (s.gain_db / 20.0))
        if jammer is not None:
            for line, part in zip(self._jammers, np.atleast_2d(jammer), strict=True):
                line.push(part)
        if self.auxiliary is not None:
            echo = self._return(1)
            read = None if jammer is None else self._read_direction
            interference, other = self.auxiliary.receive(self._block, echo, read)
            whole[:] = echo + interference
            if second is not None:
                second[:] = gain * other[0]
                self.auxiliary.finish(second, 1, float(gain))
        elif jammer is None:
            whole[:] = self._return(count)
        else:
            np.add(self._return(count), self._interference(count), out=whole, dtype=np.complex64)
        if s.gain_db:
            out *= gain
        self._impair(out)
        if self.auxiliary is not None:
            self.auxiliary.finish(out, 0, float(gain))
        first = self._block * self._n
        self._block += count
        return self._cut(first, out)

    def _read_direction(self, direction: int, delay_s: float) -> np.ndarray:
        """(1, N) interference from a direction with a further delay."""
        return self._interference(1, self._jammers[direction], delay_s * self.waveform.rate_hz)

    def _return(self, count: int) -> np.ndarray:
        """The radar's own signal at the receiver: (count, N), or (N,) where it is made frame by frame."""
        if self.true_delay is None:
            return self._paths(self.latency_samples, count)
        n = self._n
        # the altitude belongs to the frame at the receiver: the latency shifts frame boundaries inside this block
        boundary = int(np.ceil(self.latency_samples)) % n
        index = self._block - int(np.ceil(self.latency_samples)) // n
        if not boundary:
            return self._delayed(index)
        before, after = self._delayed(index - 1)[:boundary], self._delayed(index)[boundary:]
        return np.concatenate([before, after])

    def _paths(self, delay_samples: float, count: int = 1) -> np.ndarray:
        """(count, N) delayed transmitted stream, through the return's multipath if there is any."""
        multipath = self.settings.return_multipath
        if self._gains is None or multipath is None:
            return self._radar.read(delay_samples, count)
        delays = delay_samples + multipath.delays_s * self.waveform.rate_hz
        gains = self._gains[:, min(self._block, self._gains.shape[1] - 1)]
        return sum(np.complex64(g) * self._radar.read(d) for g, d in zip(gains, delays, strict=True))

    def _delayed(self, frame: int) -> np.ndarray:
        """(N,) return from the altitude of frame ``frame`` in this block: delay, carrier phase, Doppler, leakage."""
        n, w = self._n, self.waveform
        assert self.true_delay is not None
        altitude = float(self.true_delay.altitude_m(frame))
        speed = float(self.true_delay.speed_m_per_s(frame))
        leakage = self._leakage()
        if leakage is not None and not self.true_delay.is_trial(frame):
            return leakage
        delay_s = float(altitude_to_delay_s(altitude))
        out = self._paths(self.latency_samples + delay_s * w.rate_hz)[0]
        carrier = -np.mod(w.carrier_hz * delay_s, 1.0)
        if speed:
            # time since the middle of the frame, in this block's samples
            t = (np.arange(n) + self._block * n - self.latency_samples) / w.rate_hz
            t -= (frame + 0.5) * w.sweep_s
            out = out * exp_cycles(carrier - float(w.vertical_speed_to_doppler_hz(speed)) * t)
        else:
            out = out * np.complex64(np.exp(2j * np.pi * carrier))
        return out if leakage is None else out + leakage

    def _leakage(self) -> np.ndarray | None:
        """(N,) leakage and gear echo in this block; None without leakage."""
        s, total = self.settings, None
        for level_db, distance_m in ((s.leakage_db, s.leakage_m), (s.gear_db, s.gear_m)):
            if level_db is None:
                continue
            delay_s = float(altitude_to_delay_s(distance_m))
            line = self._radar.read(self.latency_samples + delay_s * self.waveform.rate_hz)[0]
            carrier = np.exp(-2j * np.pi * np.mod(self.waveform.carrier_hz * delay_s, 1.0))
            line = np.complex64(10.0 ** (level_db / 20.0) * carrier) * line
            total = line if total is None else total + line
        return total

    def _interference(
        self, count: int, line: DelayLine | None = None, later_samples: float = 0.0
    ) -> np.ndarray:
        """(count, N) the jammer at the receiver."""
        s, n = self.settings, self._n
        delay = self._jammer_base + later_samples
        if s.jammer_clock_ppm:
            # after one frame of drift the jammer skips or repeats a frame, so that the delay line stays finite
            delay -= np.fmod(s.jammer_clock_ppm * 1e-6 * self._block * n, n)
            delay = round(delay * STEPS) / STEPS
        out = (line or self._jammers[0]).read(delay, count)
        if s.jammer_lo_offset_hz:
            t = np.arange(n) + float(self._block) * n
            out = out * exp_cycles(t * (s.jammer_lo_offset_hz / self.waveform.rate_hz))
        return out

    def _impair(self, out: np.ndarray) -> None:
        """Noise, DC offset, IQ imbalance and ADC, in place, in the order of a receiver."""
        s = self.settings
        if s.snr_db is not None:
            self._noise.add(out, 10.0 ** ((s.gain_db - s.snr_db) / 10.0))
        if s.dc_offset:
            out += np.complex64(s.dc_offset)
        if s.iq_gain_db or s.iq_phase_deg:
            phase = np.deg2rad(s.iq_phase_deg)
            turned = np.float32(np.cos(phase)) * out.imag + np.float32(np.sin(phase)) * out.real
            out.imag = np.float32(10.0 ** (s.iq_gain_db / 20.0)) * turned
        if s.adc_bits:
            convert(out, s.adc_bits, s.full_scale)

    def _cut(self, first: int, out: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Remove gaps from the block that starts at sample counter ``first``."""
        pieces, at = [], first
        end = first + out.size
        while self._gaps and self._gaps[0][0] < end:
            start, length = self._gaps[0]
            if start > at:
                pieces.append((at, out[at - first : start - first]))
            at = max(at, start + length)
            if at > end:
                break
            self._gaps.pop(0)
        if at < end:
            pieces.append((at, out[at - first :]))
        return pieces
