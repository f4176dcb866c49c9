"""Planning problems of mechanisms, as formulations for the transcription and cases for refinement.

In: a `Problem`, a guess and a mesh. Out: its `Formulation` with reduced dynamics and lifted dependent coordinates, a
solution as a `Trajectory`, and prescribed motions, which need inverse dynamics only.
"""
