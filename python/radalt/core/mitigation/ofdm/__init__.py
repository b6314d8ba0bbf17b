"""Blind reception of cyclic-prefix OFDM, as far as it takes to subtract it from a frame.

Data flow: `acquisition` finds spacing, timing, carrier, long prefix and phases; `demodulator` estimates the channel and
decides the subcarriers' points in turns (`lattice`, `channel_fit`), at first in `first_reading`. The result is symbols
that were `received`, and with their samples a `demodulated` frame; `ridge` separates data and return in the elements
that hold both. A channel that moves is estimated once more together with the return (`settled`). A frame that goes on
as the one before is read with what that one told (`steady`).
"""
