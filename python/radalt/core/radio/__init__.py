"""Two B210s in plain Python: calibration, levels, transmit interlock, recordings, remote control."""
