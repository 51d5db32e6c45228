"""What the world does between two commands: exact responses, and the generated step that plays them."""
