"""Rows of studies as the tests of tables and figures need them."""

from evaluation.studies import estimation


def estimation_rows():
    return [
        {
            "observation": o, "std": s, "method": m, "sequence": k, "error": "",
            "error_squared": (1.0 + k) * (s**2 + 1e-6) * 10.0,
        }
        for o in estimation.OBSERVATIONS
        for s in estimation.noise_levels(3)
        for m in estimation.METHODS
        for k in range(3)
    ]  # fmt: skip


def episode_rows():
    """Two egos, three seeds; the second is 1 s slower and fails once."""
    rows = []
    for ego, late in (("infer-gamma", 0.0), ("assume-gamma-1", 1.0)):
        for seed in range(3):
            row = {"ego": ego, "seed": seed, "error": ""}
            row |= {"collision": False, "goal_reached": True, "time_out": False}
            row |= {
                "time": 3.0 + seed + late,
                "min_distance": 0.5 - 0.1 * seed,
                "cost": 10.0 * seed,
            }
            row |= {
                "interventions": 4,
                "failed_plans": 1,
                "failed_fits": 2,
                "latencies": [30.0, 40.0, 10.0, 20.0],
            }
            rows.append(row)
    rows[-1] = {**dict.fromkeys(rows[-1]), "ego": "assume-gamma-1", "seed": 2, "error": "no luck"}
    rows[1] |= {"goal_reached": False, "time_out": True}
    return rows
