"""Hides everyone but the owner: segmentation, tracking, matching of tags to silhouettes, and the cut."""
