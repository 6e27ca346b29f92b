"""A PyTorch model as a predictor: `python examples/own_torch_predictor.py` (`pip install torch`).

A recurrent network predicts each agent's change of velocity from its recent velocities. Here it is
trained for some seconds on straight walks: put your own training there. The library does not import
PyTorch: NumPy arrays go in and come out. On the command line: `own_torch_predictor:Recurrent`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from agents import Forecast, History
from agents.conformance import check_predictor

WEIGHTS = Path(__file__).with_suffix(".safetensors")
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


class DisplacementNetwork(torch.nn.Module):
    """From velocities (N, K, 2) to changes of velocity (N, 2), m/s."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.memory = torch.nn.GRU(2, width, batch_first=True)
        self.change = torch.nn.Linear(width, 2)

    def forward(self, velocities: torch.Tensor) -> torch.Tensor:
        """One change for each agent, from how much its velocity differed before (0.1 m/s is 1)."""
        _, last = self.memory(10.0 * (velocities - velocities[:, -1:]))
        return 0.1 * self.change(last[0])


class Recurrent:
    """The predictor: a name, and `predict`."""

    name = "recurrent"

    def __init__(self, weights: Path | None = None) -> None:
        """Weights from a file, else from `WEIGHTS` where that exists, else a new network."""
        torch.manual_seed(0)
        self.network = DisplacementNetwork().to(DEVICE).eval()
        path = weights or (WEIGHTS if WEIGHTS.exists() else None)
        if path is not None:
            # Not `torch.load`, which unpickles: such a file may run any code that it likes.
            self.network.load_state_dict(load_file(path, DEVICE))

    @torch.no_grad()
    def predict(self, history: History, steps: int) -> Forecast:
        """Constant motion with the last observed velocity, changed by the network."""
        seen = filled(history.states)
        velocities = torch.as_tensor(seen[..., 2:].swapaxes(0, 1), dtype=torch.float32)
        change = self.network(velocities.to(DEVICE)).cpu().numpy().astype(float)
        times = history.dt * np.arange(1, steps + 1)[:, None, None]
        paths = seen[-1, :, :2] + times * (seen[-1, :, 2:] + change)
        return Forecast(paths[None], np.ones(1))


def filled(states: np.ndarray) -> np.ndarray:
    """States without gaps: unobserved agents keep the state before, or have the first."""
    found = states.copy()
    for agent in range(states.shape[1]):
        known = np.flatnonzero(~np.isnan(states[:, agent]).any(axis=1))
        before = np.searchsorted(known, np.arange(len(states)), side="right") - 1
        found[:, agent] = states[known[np.maximum(before, 0)], agent]
    return found


def train(network: DisplacementNetwork, rounds: int = 100) -> list[float]:
    """Learn that people go straight on; the losses."""
    generator = torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    losses = []
    for _ in range(rounds):
        velocity = torch.randn(64, 1, 2, generator=generator)
        noisy = velocity + 0.1 * torch.randn(64, 8, 2, generator=generator)
        wanted = velocity[:, 0] - noisy[:, -1]
        loss = torch.mean((network(noisy.to(DEVICE)) - wanted.to(DEVICE)) ** 2)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    return losses


def main() -> list[float]:
    """Train, write the weights to a file, check what reads them; the losses."""
    model = Recurrent()
    losses = train(model.network.train())
    print(f"loss {losses[0]:.4f} at first, {losses[-1]:.4f} at last")
    with TemporaryDirectory() as folder:
        path = Path(folder) / WEIGHTS.name  # yours go to `WEIGHTS`, where `Recurrent()` finds them
        save_file(model.network.state_dict(), path)
        check_predictor(Recurrent(path))
    print("conforms")
    return losses


if __name__ == "__main__":
    main()
