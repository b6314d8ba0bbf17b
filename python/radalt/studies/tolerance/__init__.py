"""At which interference power at the port an altimeter stops being usable, in absolute units."""
