"""What tests share: machines, commands, campaigns, places of files."""
