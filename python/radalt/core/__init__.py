"""Signal processing of the altimeter in pure NumPy and SciPy.

Waveforms, returns, interference, mitigation, detection and scenes, as frozen dataclasses and functions of
arrays. Nothing here imports GNU Radio, onnxruntime, matplotlib or zmq at module level, so the blocks, the
training and the sweeps all stand on the same code and it is tested without any of them.
"""
