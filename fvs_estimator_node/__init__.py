"""Estimators of the 3x6 hand-eye Jacobian, their offline training and data collection."""
