"""The validator of VLP-16 traffic, which checks if a real sensor could have sent it."""
