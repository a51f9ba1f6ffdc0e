"""What is built of the guides: pages from the program itself, drawings, and checks of both."""
