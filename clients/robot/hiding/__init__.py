"""Hides everyone but the owner: segmentation and cutting."""
