"""What launch files are made of: arguments, processes that are started again, keys of SROS 2; installs the configuration."""
