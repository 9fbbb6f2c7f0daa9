"""Hides everyone but the owner: segmentation, tracking, tag matching, and cutting."""
