#pragma once  // Nebula's decoders include it, and use nothing of it
