"""The fit of `pose.probability`: pairs, their evidence, the model, a report."""
