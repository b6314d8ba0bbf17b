"""The landing study: altitude error over an approach, RMSE against SINR (`flowgraphs/landing_eval.py`).

`study` what is asked, `points` how one point is measured, `variants` the sensitivity table's assumptions, `rows`,
`report` and `figures` what is written.
"""
