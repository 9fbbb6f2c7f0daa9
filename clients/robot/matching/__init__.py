"""Which silhouette wears which tag, by distances and bearings over time."""
