"""The landing study: altitude error over an approach, error against SINR (`flowgraphs/landing_eval.py`).

`config` the study's file, `points` how one point is measured, `assumptions` the rows of the sensitivity table, `study`
what the engine runs, `report` and `figures` what is written.
"""
