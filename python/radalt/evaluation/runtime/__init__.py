"""Study: error of every method and model variant against its CPU time."""
