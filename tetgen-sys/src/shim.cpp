// Calls TetGen 1.5 stage by stage and survives its errors.
//
// Copyright (C) 2026 the lumenmesh authors. The order of the stages in run() follows
// tetrahedralize() of TetGen 1.5, copyright (C) 2002-2013 Hang Si.
//
// This program is free software: you can redistribute it and/or modify it under the terms of the
// GNU Affero General Public License as published by the Free Software Foundation, either version 3
// of the License, or (at your option) any later version.
//
// This program is distributed in the hope that it will be useful, but WITHOUT ANY WARRANTY; without
// even the implied warranty of MERCHANTABILITY or FITNESS FOR A PARTICULAR PURPOSE. See the GNU
// Affero General Public License for more details.
//
// You should have received a copy of the GNU Affero General Public License along with this program.
// If not, see <https://www.gnu.org/licenses/>.
//
// Why not tetrahedralize(): on an error TetGen frees its mesh and throws an int; unwinding
// tetrahedralize() then destroys the mesh a second time and the process dies. Here the mesh lives in
// raw storage and is not destroyed after an error. TetGen keeps file-static state: one call at a time.

#include <tetgen.h>

#include <sys/resource.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <new>
#include <string>
#include <vector>

namespace {

enum Stage { DELAUNAY = 1, SURFACE, RECOVERY, EXTERIOR, SUPPRESSION, INSERTION, REFINEMENT, OPTIMISATION, OUTPUT };

typedef void (*StageCallback)(int stage, void *context);

void run(tetgenmesh &m, tetgenbehavior *b, tetgenio *in, tetgenio *out, StageCallback at, void *context) {
  clock_t ts;
  m.b = b;
  m.in = in;
  m.addin = NULL;
  at(DELAUNAY, context);
  m.initializepools();
  m.transfernodes();
  ::exactinit(b->verbose, b->noexact, b->nostaticfilter, m.xmax - m.xmin, m.ymax - m.ymin, m.zmax - m.zmin);
  m.incrementaldelaunay(ts);
  if (b->plc) {
    at(SURFACE, context);
    m.meshsurface();
    at(RECOVERY, context);
    if (b->nobisect) {
      m.recoverboundary(ts);
    } else {
      m.constraineddelaunay(ts);
    }
    at(EXTERIOR, context);
    m.carveholes();
    if (b->nobisect && m.subvertstack->objects > 0l) {
      at(SUPPRESSION, context);
      m.suppresssteinerpoints();
    }
    if (b->nobisect) {
      m.recoverdelaunay();
    }
  }
  if (b->quality) {
    at(REFINEMENT, context);
    m.delaunayrefinement();
  }
  if (b->plc && b->optlevel > 0) {
    at(OPTIMISATION, context);
    m.optimizemesh();
  }
  at(OUTPUT, context);
  if (!b->nojettison && (m.dupverts > 0 || m.unuverts > 0)) {
    m.jettisonnodes();
  }
  out->firstnumber = in->firstnumber;
  out->mesh_dim = in->mesh_dim;
  m.outnodes(out);
  if (m.tetrahedrons->items > 0l) {
    m.outelements(out);
  }
  if (b->plc && m.subfaces->items > 0l) {
    m.outsubfaces(out);
  }
}

} // namespace

extern "C" {

struct lm_tetgen_input {
  const double *points;   // 3 a point
  const double *sizes;    // 1 a point, or NULL
  size_t point_count;
  const int *triangles;   // 3 a facet
  const int *markers;     // 1 a facet
  size_t triangle_count;
};

struct lm_tetgen_output {
  void *owner;
  const double *points;
  size_t point_count;
  const int *tets;
  size_t tet_count;
  const int *faces;
  const int *markers;
  size_t face_count;
};

// 0, or TetGen's code: 1 memory, 2 internal, 3 crossing facets, 4 tiny feature, 5 facets that nearly
// coincide, 10 input; -1 for anything else thrown.
int lm_tetgen_run(const char *switches, const lm_tetgen_input *input, StageCallback at, void *context,
                  lm_tetgen_output *output) {
  std::memset(output, 0, sizeof *output);
  tetgenio *out = NULL;
  void *storage = NULL;
  int code = 0;
  try {
    tetgenio in;
    in.firstnumber = 0;
    in.numberofpoints = (int)input->point_count;
    in.pointlist = new REAL[3 * input->point_count];
    std::memcpy(in.pointlist, input->points, 3 * input->point_count * sizeof(REAL));
    if (input->sizes) {
      in.numberofpointmtrs = 1;
      in.pointmtrlist = new REAL[input->point_count];
      std::memcpy(in.pointmtrlist, input->sizes, input->point_count * sizeof(REAL));
    }
    size_t n = input->triangle_count;
    in.facetlist = new tetgenio::facet[n];
    for (size_t i = 0; i < n; i++) {
      tetgenio::init(&in.facetlist[i]);
    }
    in.numberoffacets = (int)n;
    in.facetmarkerlist = new int[n];
    for (size_t i = 0; i < n; i++) {
      tetgenio::facet &f = in.facetlist[i];
      f.polygonlist = new tetgenio::polygon[1];
      f.numberofpolygons = 1;
      f.polygonlist[0].numberofvertices = 3;
      f.polygonlist[0].vertexlist = new int[3];
      std::memcpy(f.polygonlist[0].vertexlist, input->triangles + 3 * i, 3 * sizeof(int));
      in.facetmarkerlist[i] = input->markers[i];
    }
    tetgenbehavior b;
    std::vector<char> line(switches, switches + std::strlen(switches) + 1);
    if (!b.parse_commandline(line.data())) {
      return 10;
    }
    out = new tetgenio;
    storage = ::operator new(sizeof(tetgenmesh));
    tetgenmesh *m = new (storage) tetgenmesh();
    run(*m, &b, &in, out, at, context);
    m->~tetgenmesh();
  } catch (int x) {
    code = x ? x : -1;
  } catch (const std::bad_alloc &) {
    code = 1;
  } catch (...) {
    code = -1;
  }
  // After an error TetGen has freed what the mesh held: only the raw storage is left.
  ::operator delete(storage);
  if (code) {
    delete out;
    return code;
  }
  output->owner = out;
  output->points = out->pointlist;
  output->point_count = out->numberofpoints;
  output->tets = out->tetrahedronlist;
  output->tet_count = out->numberofcorners == 4 ? out->numberoftetrahedra : 0;
  output->faces = out->trifacelist;
  output->markers = out->trifacemarkerlist;
  output->face_count = out->trifacelist ? out->numberoftrifaces : 0;
  return 0;
}

void lm_tetgen_free(lm_tetgen_output *output) {
  delete static_cast<tetgenio *>(output->owner);
  std::memset(output, 0, sizeof *output);
}

// Limits the address space of this process; 0 or -1.
int lm_limit_memory(unsigned long long bytes) {
  struct rlimit r;
  r.rlim_cur = r.rlim_max = (rlim_t)bytes;
  int e = setrlimit(RLIMIT_AS, &r);
  struct rlimit core = {0, 0};
  setrlimit(RLIMIT_CORE, &core);
  return e;
}

// Sends what is printed to file descriptor 1 to descriptor 2; 0 or -1.
int lm_stdout_to_stderr(void) {
  std::fflush(stdout);
  return dup2(2, 1) < 0 ? -1 : 0;
}

} // extern "C"
