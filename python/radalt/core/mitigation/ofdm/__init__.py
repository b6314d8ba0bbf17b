"""Blind OFDM receiver, a file per step: `iterative_receiver` has the walk of a frame, `OfdmCancel` the front."""
