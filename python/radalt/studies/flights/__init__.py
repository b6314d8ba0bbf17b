"""Flights below base stations that transmit continuously, per frame and tracked."""
