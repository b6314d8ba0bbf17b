"""Blind reception of cyclic-prefix OFDM, as far as it takes to subtract it from a frame.

The way of the data: `acquisition` finds spacing, timing, carrier, long prefix and phases; `demodulator` estimates the
channel and decides the subcarriers' points in turns (`lattice`, `channel_fit`); `ridge` weighs the elements that hold
the return too.
"""
