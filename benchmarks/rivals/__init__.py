"""The methods that the paper compares with, as matchers of the benchmarks alone."""
