#include "server/mesh/read_mesh.h"
