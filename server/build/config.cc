#include "server/build/config.h"
