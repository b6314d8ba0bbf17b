"""The one experiment: cases as data, one frame maker, one chain, one row."""
