"""Between the antennas: the simulated air and front end of two B210s."""
