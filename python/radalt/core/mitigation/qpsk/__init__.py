"""Blind QPSK receiver: symbol timing, equaliser, carrier, pulse; and tracking of an emitter from frame to frame."""
