"""The reduced elastic body: what it holds, how it is built, its file."""

from morembs.body.body import NODE_CHOICES, VTK_VERTEX, Cells, ElasticBody, Part, elastic_body, make_part

__all__ = ["NODE_CHOICES", "VTK_VERTEX", "Cells", "ElasticBody", "Part", "elastic_body", "make_part"]
