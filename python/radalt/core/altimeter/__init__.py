"""From a frame of samples to its altitude: dechirp and decimation, CFAR, pairing of both half sweeps."""
