"""Cancellation of OFDM: over modulations, loads, channels and radios, from SIR 0 to -60 dB."""
