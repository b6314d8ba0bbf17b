"""Transmit interlock: the air is regulated, 4.2-4.4 GHz is a safety-of-life band (docs/design.md)."""

from ..scene import Scene
from .levels import rx_level_dbm

_ALTIMETER_BAND_HZ = (4.2e9, 4.4e9)  # ITU Radio Regulations
# least attenuation of a cabled set-up at any gain, dB: a mistyped gain must not reach the receiver's limit
_MIN_CABLED_ATTENUATION_DB = 30.0


class InterlockError(ValueError):
    """Transmission refused; the message is one line for the user."""


def require_enclosure(scene: Scene, transmit: bool, *, radios: bool = True) -> None:
    """Refuse to build transmitters unless both the scene and the command line (``transmit``) allow it.

    Raises `InterlockError` without an enclosure, with numbers outside the radios' ranges, with too little attenuation
    for the gains, or without ``transmit``; never where there are no ``radios``, in simulation.
    """
    if not radios:
        return
    if scene.radio.enclosure == "none":
        raise InterlockError(
            f"transmit refused: {_why(scene)} and radio.enclosure is 'none'; state 'cabled' with "
            "attenuation_db, or 'shielded', in the scene"
        )
    check_radio(scene)
    check_levels(scene)
    if not transmit:
        raise InterlockError(
            "transmit is off: add --transmit (or set the flowgraph's parameter transmit to 1)"
        )


def check_radio(scene: Scene) -> None:
    """Refuse combinations of ``radio`` and ``waveform`` that the scene's radios cannot carry out.

    Raises `InterlockError` if the sweep leaves the radios' tuning range, or its rate their rates; if both transmitters
    may be one device, or the master clock is no multiple of the rate or has no room for the LO offset.
    """
    radio, w, limits = scene.radio, scene.waveform, scene.radio.limits
    for name, low, high, (bottom, top) in (
        ("rate_hz", w.rate_hz, w.rate_hz, limits.rate_hz),
        ("carrier_hz", w.carrier_hz - w.rate_hz / 2, w.carrier_hz + w.rate_hz / 2, limits.tuning_hz),
    ):
        if low < bottom or high > top:
            raise InterlockError(
                f"transmit refused: waveform.{name} is {getattr(w, name):g}, and a {limits.title} has "
                f"{bottom:g}..{top:g}; change the waveform or name another radio.device"
            )
    if scene.has_jammer and (
        not radio.radar_serial or not radio.jammer_serial or radio.radar_serial == radio.jammer_serial
    ):
        raise InterlockError(
            f"transmit refused: with a jammer radio.radar_serial {radio.radar_serial!r} and jammer_serial "
            f"{radio.jammer_serial!r} have to name two devices; uhd_find_devices lists serials"
        )
    divider = radio.master_clock_hz / w.rate_hz
    if divider < 1 or abs(divider - round(divider)) > 1e-9 * divider:
        raise InterlockError(
            f"transmit refused: radio.master_clock_hz {radio.master_clock_hz:g} is not a whole multiple of the rate "
            f"{w.rate_hz:g} S/s; choose one that is, 30e6 for 7.5e6"
        )
    if scene.auxiliary is not None and radio.master_clock_hz > limits.two_channels_hz:
        raise InterlockError(
            f"transmit refused: radio.master_clock_hz is {radio.master_clock_hz:g}, and with two receive channels a "
            f"{limits.title} has at most {limits.two_channels_hz:g}; lower it, or leave the section auxiliary out"
        )
    room = 0.5 * (radio.master_clock_hz - w.rate_hz)
    if abs(radio.lo_offset_hz) > room:
        raise InterlockError(
            f"transmit refused: radio.lo_offset_hz is {radio.lo_offset_hz:g}; the sweep has to stay within the master "
            f"clock's band: at most {room:g} either way"
        )


def check_levels(scene: Scene) -> None:
    """Refuse gains and attenuation that could damage the receiver.

    Raises `InterlockError` if a cabled set-up states less than 30 dB, or an input of the receiver exceeds its limit
    (`rx_level_dbm`).
    """
    radio, limits = scene.radio, scene.radio.limits
    keys = ("attenuation_db",) if scene.auxiliary is None else ("attenuation_db", "auxiliary_attenuation_db")
    for key in keys:
        loss_db = getattr(radio, key)
        if radio.enclosure == "cabled" and loss_db < _MIN_CABLED_ATTENUATION_DB:
            raise InterlockError(
                f"transmit refused: radio.{key} is {loss_db:g} with a cabled set-up; a "
                f"{limits.title} receiver is damaged above {limits.max_rx_dbm:g} dBm and transmits up to "
                f"{limits.max_tx_dbm:+g} dBm: use at least {_MIN_CABLED_ATTENUATION_DB:g} dB (40 dB is usual)"
            )
        level = rx_level_dbm(radio, scene.has_jammer, loss_db)
        if level > limits.max_rx_dbm:
            raise InterlockError(
                f"transmit refused: up to {level:.1f} dBm would reach the receiver, which is damaged above "
                f"{limits.max_rx_dbm:g} dBm; lower the transmit gains or raise {key} by "
                f"{level - limits.max_rx_dbm:.1f} dB"
            )


def _why(scene: Scene) -> str:
    """Reason why open transmission is unlawful at the scene's frequencies."""
    w = scene.waveform
    low, high = w.carrier_hz - w.rate_hz / 2, w.carrier_hz + w.rate_hz / 2
    if low < _ALTIMETER_BAND_HZ[1] and high > _ALTIMETER_BAND_HZ[0]:
        return "4.2-4.4 GHz is a safety-of-life band"
    return f"{w.carrier_hz / 1e9:g} GHz is not free to use"
