"""Published numbers of prediction protocols, for comparison."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PublishedPrediction:
    """An average over the five scenes of ETH/UCY."""

    name: str
    source: str
    futures: int
    """K: errors are of the best of so many."""
    ade: float
    """m."""
    fde: float

    @property
    def label(self) -> str:
        """Name and source."""
        return f"{self.name} ({self.source})"


ETH_UCY = (
    PublishedPrediction("constant velocity", "Schoeller et al., RA-L 2020", 1, 0.39, 0.83),
    PublishedPrediction("STAR-D", "Yu et al., ECCV 2020", 1, 0.41, 0.87),
    PublishedPrediction("Social-BiGAT", "Kosaraju et al., NeurIPS 2019", 1, 0.61, 1.33),
    PublishedPrediction(
        "constant velocity, sampled angles", "Schoeller et al., RA-L 2020", 20, 0.28, 0.56
    ),
    PublishedPrediction("AgentFormer", "Yuan et al., ICCV 2021", 20, 0.18, 0.29),
    PublishedPrediction("MemoNet", "Xu et al., CVPR 2022", 20, 0.21, 0.35),
    PublishedPrediction("TUTR", "Shi et al., ICCV 2023", 20, 0.21, 0.36),
)
"""They differ from each other, and from ours, in files and rules: `docs/protocols.md`."""
