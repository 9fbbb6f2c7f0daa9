"""Real pedestrians' film through the robot's own segmentation, tracks and hiding."""
