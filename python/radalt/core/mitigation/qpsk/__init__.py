"""Blind demodulation of QPSK, in parts: symbol clock, equaliser and decisions, pulse. `QpskCancel` is made of them."""
