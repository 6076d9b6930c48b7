"""Designs and starts for them: a library, random ones, pictures and meshes."""
