"""What a point cloud is worth beside the truth."""
