"""Measurements: each ``bench_*.py`` has a ``main()`` that prints tables."""
