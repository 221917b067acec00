"""The runtimes of the network: images to features, features to maps."""
