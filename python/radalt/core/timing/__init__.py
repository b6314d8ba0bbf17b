"""Which samples are a frame: segmenter, slips, faults of the receiver, leakage, samples of a second channel."""
