"""Velodyne's rotating lidars: VLP-16, Puck Hi-Res, HDL-32E, VLP-32C, VLS-128."""
