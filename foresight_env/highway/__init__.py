"""Access to highway-env: its roads, paths along them, its drivers.

Its axes have y pointing down; everywhere else y points up. `axes` converts, at this package's edge.
"""
