"""The paper's experiment on relative pose: DTU's pairs, the protocol, the histograms."""
