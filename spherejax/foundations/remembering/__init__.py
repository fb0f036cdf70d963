"""What is made once and asked for again: keys by identity, and objects of many fields."""
