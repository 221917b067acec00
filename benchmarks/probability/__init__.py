"""The fit of `pose.probability`: pairs, stored matches, evidence, model, report."""
