"""Hides everyone but the owner: segmentation, tracking and cutting."""
