"""Machines with faults whose causes somebody wrote down: a truth table, a score, other methods."""
