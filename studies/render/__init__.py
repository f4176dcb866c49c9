"""Pictures and films of a motion as MuJoCo draws it. In: a plan, a tracker. Out: an MP4, a GIF or a PNG.

The scene (shapes, colours, framing) is independent of the painter: MuJoCo's renderer, or Matplotlib without OpenGL.
"""
