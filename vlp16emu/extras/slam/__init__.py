"""Ready configurations of SLAM programs for bags of a VLP-16, and a check whether a bag is fit for a program."""
