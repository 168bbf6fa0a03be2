"""The parts of docker/check."""
