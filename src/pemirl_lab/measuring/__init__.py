"""What policies and rewards reach: environments, experts, scores."""
