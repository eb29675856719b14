"""What `hilbench config new` asks for, and gives, by kind of machine."""
