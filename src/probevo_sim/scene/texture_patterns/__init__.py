"""How each texture is drawn: one function a tile, from a seeded generator to grey values of any
mean."""
