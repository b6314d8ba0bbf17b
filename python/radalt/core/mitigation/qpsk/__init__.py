"""Blind demodulation of QPSK, in parts: symbol clock, equaliser and decisions, pulse, and what follows an emitter.

`QpskCancel` is made of them; `JointCancel` also of `sequence` and `trains`, which read QPSK under another signal.
"""
