"""A fitted chain before a webcam, as an estimator."""

from __future__ import annotations

from typing import Any

import numpy as np

from fvs_estimator_node.base import CHAIN, Estimator
from fvs_ros.kinds import Kind
from fvs_ros.pixel_chain import AnyChain


class PixelPoeEstimator(Estimator):
    """The chain that was fitted, before the webcam where it stood then."""

    made_from = CHAIN
    learns = False

    def __init__(self, chain: AnyChain, _config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind)
        self._chain = chain

    @property
    def chain(self) -> AnyChain:
        """The chain as it was fitted."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,): m/rad, shape (d, n)."""
        return self.kind.along(self._chain, joints_rad)[1]
