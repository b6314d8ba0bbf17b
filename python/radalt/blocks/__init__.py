"""The GNU Radio blocks, one file each, named as in the companion; files with an underscore are shared helpers."""
