#include "server/store/mesh_store.h"
