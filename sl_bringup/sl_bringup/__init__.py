"""The stack as a whole: demo, replay of bags, benchmarks."""
