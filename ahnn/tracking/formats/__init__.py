"""Files of tracking data, of stations and of the Earth's orientation, refused by the line that is wrong."""
