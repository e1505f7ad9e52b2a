"""The drawings of all textures: one function for each, from a random generator to grey values.

``textures`` normalises their mean and standard deviation afterwards. ``canvas`` holds the tools
that all of them draw with.
"""
