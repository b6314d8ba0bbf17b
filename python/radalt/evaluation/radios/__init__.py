"""The flowgraph on two B210s: set-up with readback, interlock, remote control."""
