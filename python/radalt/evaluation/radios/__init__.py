"""The same flowgraph on two B210s: set-up with readback, the interlock, remote control."""
