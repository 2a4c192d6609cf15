"""Launch files, default configurations, demo, bag replay and benchmarks of the structured-light stack."""
