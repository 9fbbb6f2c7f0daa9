"""`blockrobot bench hiding`: what attackers recover of hidden people."""
