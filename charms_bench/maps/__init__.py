"""Road maps: importers of CommonRoad, OpenDRIVE and SUMO, and the road file of this project."""
