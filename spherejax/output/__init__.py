"""What leaves the program: files and figures."""
