"""The commands of the bench, one file each; `evaluation/programs.py` finds them."""
