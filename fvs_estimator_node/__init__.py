"""Estimators of the hand-eye Jacobian, their offline training and data collection."""
