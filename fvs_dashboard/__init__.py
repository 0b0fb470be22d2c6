"""``fvs_dashboard``: a page in a browser that shows arm, camera and estimator at work."""
