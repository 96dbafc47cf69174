"""The validator of VLP-16 traffic: whether a real sensor could have sent it."""
