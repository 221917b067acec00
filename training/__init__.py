"""Training on synthetic pairs: stages, losses, and runs that resume from checkpoints."""
