"""Blind OFDM receiver: synchronisation, channel estimation, soft decisions, reconstruction. Walk: `iterative_receiver`.

The files are named after the steps of the receiver. `OfdmCancel` calls `sync`, `iterative_receiver` and `tracking`.
"""
