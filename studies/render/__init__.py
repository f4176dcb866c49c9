"""Pictures and films of a motion as MuJoCo draws it. In: a plan, a tracker. Out: an MP4, a GIF or a PNG.

What is drawn (shapes, colours, framing) is worked out apart from who draws it: MuJoCo's renderer, or Matplotlib where there
is no OpenGL.
"""
