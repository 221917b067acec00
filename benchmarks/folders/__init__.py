"""The fit of what a folder believes of its pairs: folders with the truth, labels, weights."""
