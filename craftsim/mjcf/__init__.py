"""The machines as MJCF, hand-readable, and the script that makes their visual meshes."""
