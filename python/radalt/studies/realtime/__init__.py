"""Study: how much faster than the air the live flowgraph runs, and with what latency."""
