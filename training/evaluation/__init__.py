"""A network's dense maps compared with the truth: per pair, and summarised over pairs."""
