"""Sweeps, metrics and reports: runs scenes point by point and writes what was measured.

A point of a sweep is given by (scene, point, seed) alone, so that points can be run in any order, in any
process and again, without changing a row.
"""
