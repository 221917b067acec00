"""A network's dense maps against the truth: per pair, and summed over pairs."""
