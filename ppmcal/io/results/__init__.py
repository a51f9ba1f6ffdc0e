"""What each command writes, and reads again: entries, tables and their wording."""
