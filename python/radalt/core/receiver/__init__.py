"""From received samples to an altitude: segmenter, dechirp and decimation, CFAR, pairing of both half sweeps."""
