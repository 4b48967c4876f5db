"""What several benchmarks and tests share: the closed form of a free body, batches of runs, and other programs."""
