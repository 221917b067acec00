"""From the matches of a batch to a COLMAP database and a reconstruction."""
