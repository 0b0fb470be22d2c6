"""Hundreds of random worlds of the usual kind, in which no scheme worth using may fail."""

from __future__ import annotations

from fvs_lab.robustness import experiment_in
from fvs_lab.worlds import EVERYDAY

EXPERIMENT = experiment_in(EVERYDAY)
