"""Many pairs of photographs: matches and poses, on the cores of one machine or on a cluster."""
