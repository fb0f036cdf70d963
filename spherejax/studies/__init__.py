"""What an effect costs, and comparisons."""
