"""Study: whether a tracked altitude that is called NORMAL can be trusted, over interference, faults and deception."""
