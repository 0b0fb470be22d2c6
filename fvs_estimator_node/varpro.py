"""Variable projection in torch: gradients for centres and widths, the weights solved for inside.

The error of a batch is a function of centres and widths alone once the weights are the best ones
for them (a ridge regression). At those weights its gradient is the gradient with the weights held
fixed, so that the solution itself need not be differentiated. This is the only module that imports
torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from threadpoolctl import threadpool_limits

#: Start and end joints, rad, shape (p, n) each, and the ball's motion between them, m, (p, m).
Batch = tuple[np.ndarray, np.ndarray, np.ndarray]

_BETAS = (0.9, 0.99)


def refine(
    neurons: tuple[np.ndarray, np.ndarray],
    draw: Callable[[], Batch],
    quadrature: tuple[np.ndarray, np.ndarray],
    ridge: float,
    learning_rate: float,
    iterations: int,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Move centres and widths by Adam so that the networks predict the ball's motion better.

    Takes initial centres, (n, k, n), and widths, (n, k), rad; a function that draws the next batch;
    quadrature nodes in [0, 1] between two joint positions, and their weights; the ridge relative to
    the mean diagonal; Adam's first step for centres (rad) and log widths, which decays to zero.
    Yields centres and widths after each iteration.
    """
    centres, widths = neurons
    networks = [
        (
            torch.tensor(centres[i], dtype=torch.float64, requires_grad=True),
            torch.tensor(np.log(widths[i]), dtype=torch.float64, requires_grad=True),
        )
        for i in range(len(widths))
    ]
    variables = [variable for network in networks for variable in network]
    adam = torch.optim.Adam(variables, lr=learning_rate, betas=_BETAS)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, iterations)
    for _ in range(iterations):
        start, end, motion = (torch.from_numpy(np.ascontiguousarray(a)) for a in draw())
        with threadpool_limits(1):  # for matrices this small, threads mostly wait for each other
            adam.zero_grad()
            _relative_squared_error(networks, start, end, motion, *quadrature, ridge).backward()
            adam.step()
            schedule.step()
        with torch.no_grad():
            centres = torch.stack([c for c, _ in networks]).numpy()
            widths = torch.stack([w for _, w in networks]).exp().numpy()
        yield centres, widths


def _relative_squared_error(
    networks: list[tuple[torch.Tensor, torch.Tensor]],
    start: torch.Tensor,
    end: torch.Tensor,
    motion: torch.Tensor,
    nodes: np.ndarray,
    node_weights: np.ndarray,
    ridge: float,
) -> torch.Tensor:
    """Squared error over squared motion, with the best weights for the present neurons."""
    joint_motion = end - start
    columns = []
    for i, (centres, log_widths) in enumerate(networks):
        integral = torch.zeros((), dtype=motion.dtype)
        for node, node_weight in zip(nodes.tolist(), node_weights.tolist(), strict=True):
            points = start + node * joint_motion
            # (|r - u| / delta)^2 of eq. (8), shape (p, k)
            squares = (points**2).sum(1, keepdim=True) + (centres**2).sum(1)
            squares = (squares - 2.0 * points @ centres.T) * torch.exp(-2.0 * log_widths)
            integral = integral + node_weight * torch.exp(-squares)
        columns.append(integral * joint_motion[:, i : i + 1])
    regressors = torch.cat(columns, dim=1)
    with torch.no_grad():
        gram = regressors.T @ regressors
        gram += ridge * gram.trace() / len(gram) * torch.eye(len(gram), dtype=gram.dtype)
        weights = torch.linalg.solve(gram, regressors.T @ motion)
    return ((regressors @ weights - motion) ** 2).sum() / (motion**2).sum()
