"""Fixed numbers of the network, which every library that runs it needs."""

EPSILON = 1e-6  # under the root of a feature's length
PEAK = (0.01, 0.99)  # bounds of the peak's probability, from which the coarsest mask logit starts
PEAK_WINDOW = 2  # cells along each axis around the highest that belong to the peak

# Of the consensus. Chosen on training photographs; factors from one half to two change little.
PASSES = 4  # rounds of belief propagation
REACH = 1.4  # source cells, sigma of a neighbour's match about the match plus the cells' offset
WEIGHT = 0.4  # of the messages: neighbours are not independent of each other
FLOOR = 0.01  # smallest message: the neighbour may lie on another surface

MEAN = (0.485, 0.456, 0.406)  # of ImageNet's channels, which the network's input is normalised by
DEVIATION = (0.229, 0.224, 0.225)
