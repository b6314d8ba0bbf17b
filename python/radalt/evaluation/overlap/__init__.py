"""The main study: probability of correct altitude against overlap, for every method, through GNU Radio."""
