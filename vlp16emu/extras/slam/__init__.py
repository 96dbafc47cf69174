"""What SLAM programs read of bags of a VLP-16: ready configurations, and whether a bag is fit for a program."""
