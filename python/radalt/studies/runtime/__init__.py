"""Study: error of every method, network and choice of the altimeter against its CPU time."""
