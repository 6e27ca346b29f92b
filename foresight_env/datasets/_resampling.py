"""Linear interpolation of one track onto an even time grid, never across a gap."""

import numpy as np
from jaxtyping import Float, Int

# Times are quotients of frame numbers and rates, so equal instants differ in the last digits.
_TOLERANCE = 1e-6


def resample_rows(
    times: Float[np.ndarray, " F"],
    values: Float[np.ndarray, "F 4"],
    heading: Float[np.ndarray, " F"],
    dt: float,
    maximal_gap: float,
) -> tuple[Int[np.ndarray, " K"], Float[np.ndarray, "K 5"]]:
    """Interpolate rows at the multiples of `dt` that the track covers.

    Args:
        times: (F,) s, strictly increasing.
        values: (F, 4) columns that are interpolated as they are.
        heading: (F,) rad, interpolated the shorter way round; NaN at either end gives NaN.
        dt: s, spacing of the grid.
        maximal_gap: s, the widest distance of two rows that is interpolated.

    Returns:
        (K,) the multiples k of `dt`, and (K, 5) the four columns and the heading there.
    """
    first = int(np.ceil(times[0] / dt - _TOLERANCE))
    last = int(np.floor(times[-1] / dt + _TOLERANCE))
    frames = np.arange(first, last + 1, dtype=np.int64)
    instants = np.clip(frames * dt, times[0], times[-1])
    if times.size == 1:
        columns = np.column_stack([values, heading])
        return frames, np.repeat(columns, frames.size, axis=0)
    left = np.clip(np.searchsorted(times, instants, side="right") - 1, 0, times.size - 2)
    spacing = times[left + 1] - times[left]
    fraction = (instants - times[left]) / spacing
    # A grid time that coincides with a row needs no interpolation: snap to it, so that it is kept
    # next to a gap and carries exactly the recorded values.
    close = _TOLERANCE * min(dt, float(spacing.min(initial=np.inf)))
    fraction = np.where(np.abs(instants - times[left]) <= close, 0.0, fraction)
    fraction = np.where(np.abs(instants - times[left + 1]) <= close, 1.0, fraction)
    on_row = (fraction == 0.0) | (fraction == 1.0)
    covered = on_row | (spacing <= maximal_gap * (1.0 + _TOLERANCE))
    frames, left, fraction = frames[covered], left[covered], fraction[covered]

    weight = fraction[:, None]
    interpolated = values[left] * (1.0 - weight) + values[left + 1] * weight
    turn = np.mod(heading[left + 1] - heading[left] + np.pi, 2 * np.pi) - np.pi
    turned = heading[left] + fraction * turn
    turned = np.where(fraction == 0.0, heading[left], turned)
    turned = np.where(fraction == 1.0, heading[left + 1], turned)
    return frames, np.column_stack([interpolated, turned])
