"""Sweeps, metrics and reports: runs scenes point by point and writes the results.

The rows of a point are a function of (scene, point, seed), so points can run in any order, in any process and
repeatedly.
"""
