"""The commands of the benchmarks and the training."""
