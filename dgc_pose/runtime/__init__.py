"""What runs the network: images to features, features to maps."""
