"""The paper's laboratory: every estimator and law in lock step, measured side by side."""
